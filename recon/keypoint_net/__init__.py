"""Train a small keypoint network on a few labels, and turn videos into keypoint files with the trained network.

The package torch (extra `net`) is imported only in the functions that need it.
"""
