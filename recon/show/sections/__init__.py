"""Define the sections of report.json and of the summary: input, keypoints, cameras, motion and search."""
