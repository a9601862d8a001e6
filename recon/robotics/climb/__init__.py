"""Climbing a step by potential fields: the torso moves by fields, the feet follow given paths (docs/climb.md).

After D. Cohen, SUNFEST, University of Pennsylvania, 2005. World: x forward, y left, z up.
"""
