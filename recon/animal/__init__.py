"""Describe animals by bodies (trees of segments), skeletons, subjects, detectors, names and motion priors."""
