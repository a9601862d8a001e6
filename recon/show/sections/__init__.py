"""Sections of report.json and of the summary: the input, the keypoints, the cameras, the motion, the search."""
