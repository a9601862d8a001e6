"""Animals: their bodies as trees of segments, files of skeletons, subjects and detectors, names, and motion priors."""
