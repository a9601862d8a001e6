"""Plan how a robot climbs a step: potential fields move the torso, and the feet follow given paths (docs/climb.md).

The method is that of D. Cohen, SUNFEST, University of Pennsylvania, 2005. In the world, x is forward, y left and z up.
"""
