"""Describe animals: bodies as trees of segments, skeletons, subjects, detectors, names, and motion priors."""
