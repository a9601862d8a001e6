"""A small keypoint network: trained on a few labels, it turns a video into a keypoint file.

It needs torch (extra `net`), which is imported where it is used.
"""
