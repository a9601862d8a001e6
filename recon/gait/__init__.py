"""Analyse an animal's motion: kinematics, stances, strides, phase portraits, and comparison with ground truth."""
