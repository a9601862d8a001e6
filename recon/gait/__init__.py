"""Analyse an animal's kinematics, stances, strides and phase portraits, and compare a motion with ground truth."""
