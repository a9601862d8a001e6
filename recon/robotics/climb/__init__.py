"""Plan how a robot climbs a step (docs/climb.md).

Potential fields move the torso, and the feet follow given paths. The method was published by D. Cohen, SUNFEST,
University of Pennsylvania, 2005. In the world, x is forward, y left and z up.
"""
