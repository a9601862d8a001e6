"""TRC file of joint positions: metres, y up (x forwards, y up, z right), as OpenSim takes it; gaps are empty cells."""

from __future__ import annotations

from pathlib import Path

from recon.export.checks import require_names, required_fps
from recon.io.pose import Pose3D, y_up_from_z_up
from recon.io.trc import UP_TEXT

TITLE = "TRC"


def write(pose: Pose3D, path: Path) -> None:
    """Raises InputError without a frame rate, or for names with tabs or line breaks."""
    fps = required_fps(pose.fps, TITLE)
    require_names(pose.names, r"[\t\r\n]|^\s|\s$", TITLE)
    header = {
        "DataRate": repr(fps),
        "CameraRate": repr(fps),
        "NumFrames": len(pose.frames),
        "NumMarkers": len(pose.names),
        "Units": "m",
        "OrigDataRate": repr(fps),
        "OrigDataStartFrame": pose.frames[0],
        "OrigNumFrames": len(pose.frames),
    }
    lines = [
        ["PathFileType", "4", "(X/Y/Z)", path.name, UP_TEXT],
        list(header),
        list(header.values()),
        ["Frame#", "Time", *(cell for name in pose.names for cell in (name, "", ""))],
        ["", "", *(f"{axis}{j + 1}" for j in range(len(pose.names)) for axis in "XYZ")],
    ]
    values = y_up_from_z_up(pose.xyz_m).reshape(len(pose.frames), -1)
    for frame, row in zip(pose.frames.tolist(), values.tolist(), strict=True):
        lines.append([frame, repr(frame / fps), *("" if v != v else repr(v) for v in row)])
    text = "".join("\t".join(map(str, line)) + "\n" for line in lines)
    path.write_text(text, encoding="utf-8", newline="")
