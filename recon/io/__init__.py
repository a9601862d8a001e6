"""Files in and out: 2D keypoints, 3D positions, bones, and cameras. `FORMATS` is the one table of formats.

Videos are in `recon.io.video`, which OpenCV makes slow to import.
"""

from typing import TYPE_CHECKING

from recon.base import lazily

if TYPE_CHECKING:
    from recon.io.bones import Armature, Bone, BoneAngle
    from recon.io.calibration import read_camera, read_cameras, write_camera, write_cameras
    from recon.io.camera_track import CameraTrack, read_camera_track, track_files, track_label
    from recon.io.formats import (
        CONVERTED,
        FORMATS,
        Format,
        as_keypoints,
        choose_format,
        file_head,
        individuals,
        read_keypoints,
        read_points,
        recognised,
        titles,
    )
    from recon.io.pose import Pose3D, StoredPoints
    from recon.io.pose3d import in_metres, read_pose3d, read_pose_segments
    from recon.io.table import write_columns, write_rows, write_table

__getattr__ = lazily(__name__, __file__)
