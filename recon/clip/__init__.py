"""What a clip consists of: for each camera its keypoints, and where it saw them from."""

from recon.clip.source import FramePoses, Source, at_rate, held, together, views_of
from recon.clip.view import View, camera_poses, still_view, world_from_reference

__all__ = [
    "FramePoses",
    "Source",
    "View",
    "at_rate",
    "camera_poses",
    "held",
    "still_view",
    "together",
    "views_of",
    "world_from_reference",
]
