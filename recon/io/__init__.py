"""Files in and out: 2D keypoints, 3D positions, bones, and cameras. `FORMATS` is the one table of formats.

Names of `recon.io.video` import OpenCV when they are first used."""

from typing import TYPE_CHECKING

from recon.base import lazily

if TYPE_CHECKING:
    from recon.io.bones import Armature, Bone, BoneAngle, write_bvh, write_gltf, write_opensim
    from recon.io.calibration import read_camera, read_cameras
    from recon.io.camera_files import write_camera, write_cameras
    from recon.io.camera_track import CameraTrack, read_camera_track, track_files, track_label
    from recon.io.columns import parse_map
    from recon.io.common import Pose3D, require_span
    from recon.io.deeplabcut import write_csv
    from recon.io.deeplabcut_project import find_project, predictions
    from recon.io.formats import CONVERTED, FORMATS, Format, individuals, read_keypoints, read_points, recognised
    from recon.io.positions import in_metres, read_pose3d, read_pose_segments
    from recon.io.video import VideoInfo, missing_frames, missing_note, probe, read_frames, timed_frames, video_writer
    from recon.io.writing import frames_text, write_rows, write_table, y_up_from_z_up

__getattr__ = lazily(__name__, __file__)
