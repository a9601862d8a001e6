"""Metric 3D motion of a running animal, from DeepLabCut keypoints of one or more cameras.

import recon

settings = recon.FitSettings(keypoints="clip.csv", camera="camera.toml", fps=120)
motion = recon.fit_clip(settings)
motion.joints_m  # (frames, joints, 3), metres
"""

import logging

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

logging.getLogger(__name__).addHandler(logging.NullHandler())  # otherwise logging prints warnings on stderr
