"""Train a small keypoint network on a few labels, and turn videos into keypoint files with it.

It needs torch (extra `net`), which is imported where it is used.
"""
