"""Metric 3D motion of a running animal from one camera and DeepLabCut keypoints.

import recon

settings = recon.FitSettings(keypoints="clip.csv", camera="camera.toml", fps=120)
motion = recon.fit_clip(settings)
motion.joints_m  # (frames, joints, 3), metres
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from recon.analysis.clip import ClipAnalysis, analyse
    from recon.analysis.evaluation import Evaluation, evaluate, evaluate_files
    from recon.app.batch import find_clips, plan_batch, run_batch
    from recon.app.calibrate import run_calibration
    from recon.app.clip import fit_clip, write_clip
    from recon.app.demo import samples_folder
    from recon.app.net import LabelSource, run_prediction, run_training
    from recon.app.prior import run_prior_fit
    from recon.app.subject import run_subject_fit
    from recon.body import Body
    from recon.calibration import read_camera, read_cameras, write_camera
    from recon.camera import Camera
    from recon.errors import InputError
    from recon.io import read_keypoints
    from recon.io.pose3d import Pose3D, read_pose3d
    from recon.keypoints import Keypoints, clean
    from recon.motion import Motion
    from recon.net.run import TrainSettings
    from recon.results import Results, read_results
    from recon.settings import FitSettings, read_settings
    from recon.skeleton_file import load_skeleton

    __version__: str

__all__ = [
    "Body",
    "Camera",
    "ClipAnalysis",
    "Evaluation",
    "FitSettings",
    "InputError",
    "Keypoints",
    "LabelSource",
    "Motion",
    "Pose3D",
    "Results",
    "TrainSettings",
    "analyse",
    "clean",
    "evaluate",
    "evaluate_files",
    "find_clips",
    "fit_clip",
    "load_skeleton",
    "plan_batch",
    "read_camera",
    "read_cameras",
    "read_keypoints",
    "read_pose3d",
    "read_results",
    "read_settings",
    "run_batch",
    "run_calibration",
    "run_prediction",
    "run_prior_fit",
    "run_subject_fit",
    "run_training",
    "samples_folder",
    "write_camera",
    "write_clip",
]

_NAMES_OF = {
    "recon.analysis.clip": ("ClipAnalysis", "analyse"),
    "recon.analysis.evaluation": ("Evaluation", "evaluate", "evaluate_files"),
    "recon.body": ("Body",),
    "recon.calibration": ("read_camera", "read_cameras", "write_camera"),
    "recon.camera": ("Camera",),
    "recon.errors": ("InputError",),
    "recon.io": ("read_keypoints",),
    "recon.io.pose3d": ("Pose3D", "read_pose3d"),
    "recon.keypoints": ("Keypoints", "clean"),
    "recon.motion": ("Motion",),
    "recon.app.batch": ("find_clips", "plan_batch", "run_batch"),
    "recon.app.calibrate": ("run_calibration",),
    "recon.app.clip": ("fit_clip", "write_clip"),
    "recon.app.demo": ("samples_folder",),
    "recon.app.net": ("LabelSource", "run_prediction", "run_training"),
    "recon.app.prior": ("run_prior_fit",),
    "recon.app.subject": ("run_subject_fit",),
    "recon.net.run": ("TrainSettings",),
    "recon.results": ("Results", "read_results"),
    "recon.settings": ("FitSettings", "read_settings"),
    "recon.skeleton_file": ("load_skeleton",),
}
"""Where each name comes from. It is imported when it is first used: `recon --help` needs none of them."""
_MODULE_OF = {name: module for module, names in _NAMES_OF.items() for name in names}


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from recon.package import version

        value: Any = version()
    elif name in _MODULE_OF:
        value = getattr(import_module(_MODULE_OF[name]), name)
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, "__version__"})
