"""Playback: a Motion as a rerun recording that opens ready to read, and the viewer on such a file.

Entities of the recording; those without "(static)" have a row a frame, which is empty where the frame has no pose:

- `world`: metres, in the motion's frame of reference. `world/skeleton` and its joints, `world/path` (static) and
  `world/trail` of the reference point, `world/ground` (of a clip with several segments each one's, from its first frame
  on), `world/camera` (static, but for one that moves), its frustum, and `world/followed`, invisible;
  `world/uncertainty`, one sigma of the joints' positions relative to their mean, red in frames with a flag, and
  `world/stance`, the feet that stand.
- `picture`: pixels of the distorted picture. `picture/frame` (static), its edge; `picture/detections`,
  `picture/outliers`, `picture/reprojections` with the skeleton's lines in it, `picture/links` between the two.
- `closeup`: the same points, relative to the middle of the reprojected skeleton in each frame.
- `picture/video`, `closeup/video`: the frames of a video, where one was given.
- Of several cameras each has its own `world/camera/<name>`, `picture/<name>/...` and `closeup/<name>/...`, and there is
  `world/camera_names`.
- `angles/...` in degrees: `left`, `right` and `middle`, in parts where they are many; `speed` of the reference point in
  m/s; `residuals` in px, of all cameras: the median of a frame, and the largest but for outliers.
- `uncertainty` in m, and states over time: by its name each flag of a frame, and each foot, where it stands.
- With an analysis `analysis/...`, and `world/forces`, arrows under the feet, with the path
  `world/forces/centre_of_mass`.

Timelines: `frame`, the frame number of the keypoint file, and `time`, seconds since its frame 0.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import rerun as rr

from recon.base.errors import InputError, Problem
from recon.fit.motion import Motion
from recon.gait.clip import ClipAnalysis
from recon.show.recording import recording
from recon.show.view.layout import blueprint
from recon.show.view.scene import Log, Scene, limb_colours, write_pictures, write_uncertainty, write_world
from recon.show.view.series import analysis_plots, angle_plots, other_plots, states, write_forces

DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET")
"""Environment variables, one of which says where a screen is on Linux."""


def write(
    motion: Motion,
    path: Path,
    found: ClipAnalysis | None = None,
    video: Path | None = None,
    first_frame: int = 0,
    camera: int = 0,
) -> None:
    """Write the recording `motion.rrd`, with the blueprint that lays out its views.

    The viewer plays it in a loop, slowly where it is short. found: the analysis, whose plots get tabs of their own;
    video: what is behind the picture of a camera, by its number, with the number of the video's first frame.
    """
    scene, stands = Scene.of(motion), (found or ClipAnalysis(motion)).standing
    plots = [*angle_plots(motion), *other_plots(motion), *(() if found is None else analysis_plots(found))]
    rows = states(motion, stands)
    with recording(path, blueprint(motion, scene, plots, [*rows])) as stream:
        stream.send_recording_name(Path(motion.keypoints.source or motion.title).stem)
        log = Log(stream, motion.frames, motion.time_s)
        labels = zip(motion.limbs, limb_colours(motion), strict=True)
        log.fix("/", rr.AnnotationContext([(i, limb, colour) for i, (limb, colour) in enumerate(labels)]))
        write_world(motion, scene, log)
        write_pictures(motion, log)
        write_uncertainty(motion, log, stands)
        for plot in plots:
            log.plot(plot)
        for entity, (text, colour, holds) in rows.items():
            log.state(entity, text, colour, holds)
        if found is not None:
            write_forces(found, log)
        if video is not None:
            from recon.show.view.video import write_video  # OpenCV

            write_video(motion, log, video, first_frame, camera)


def open_viewer(path: Path) -> None:
    """Show a recording in rerun's viewer; returns when the viewer is closed.

    Raises InputError where there is no such file or the viewer cannot run.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(Problem(path, "file", "no such file", "a recording (.rrd) that `recon fit` has written"))
    if sys.platform == "linux" and not any(os.environ.get(name) for name in DISPLAYS):
        expected = "a screen; without one: a page, by recon report DIR, or a recording, by --out FILE.rrd, for rerun"
        raise InputError(Problem("recon view", "viewer", "no display", expected))
    command = [sys.executable, "-m", "rerun", "--bind", "127.0.0.1", str(path)]
    code = subprocess.run(command, check=False).returncode
    if code:
        found = f"one that ended with exit code {code}"
        expected = "a display; or, by --out FILE.rrd, a recording of it all for a machine with one (rerun FILE.rrd)"
        raise InputError(Problem("recon view", "viewer", found, expected))
