"""The wings: robotics, the keypoint network, and the thesis' frame method.

No room of `recon` imports them but `workflows`, no wing imports another, and each uses the rooms' front doors only.
"""
