"""Metric 3D motion of a running animal from one camera and DeepLabCut keypoints.

import recon

settings = recon.FitSettings(keypoints="clip.csv", camera="camera.toml", fps=120)
motion = recon.fit_clip(settings)
motion.joints_m  # (frames, joints, 3), metres
"""

from recon.analysis.clip import ClipAnalysis, analyse
from recon.analysis.evaluation import Evaluation, evaluate, evaluate_files
from recon.body import Body
from recon.calibration import read_camera, read_cameras, write_camera
from recon.camera import Camera
from recon.errors import InputError
from recon.io import read_keypoints
from recon.io.pose3d import Pose3D, read_pose3d
from recon.keypoints import Keypoints, clean
from recon.motion import FrameMotion, Motion, TrajectoryMotion
from recon.package import version
from recon.pipelines.clip import fit_clip, write_clip
from recon.pipelines.demo import samples_folder
from recon.results import Results, read_results
from recon.settings import FitSettings
from recon.skeleton import Skeleton
from recon.skeleton_file import load_skeleton

__version__ = version()

__all__ = [
    "Body",
    "Camera",
    "ClipAnalysis",
    "Evaluation",
    "FitSettings",
    "FrameMotion",
    "InputError",
    "Keypoints",
    "Motion",
    "Pose3D",
    "Results",
    "Skeleton",
    "TrajectoryMotion",
    "analyse",
    "clean",
    "evaluate",
    "evaluate_files",
    "fit_clip",
    "load_skeleton",
    "read_camera",
    "read_cameras",
    "read_keypoints",
    "read_pose3d",
    "read_results",
    "samples_folder",
    "write_camera",
    "write_clip",
]
