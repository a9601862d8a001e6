"""Describe animals: skeleton files, measured subjects, detector offsets, keypoint names and motion priors."""
