"""What a clip consists of: for each camera its keypoints, and where it saw them from."""

from typing import TYPE_CHECKING

from recon.base import lazily

if TYPE_CHECKING:
    from recon.clip.keypoints import (
        CleaningReport,
        Keypoints,
        clean,
        fill_gaps,
        frame_ranges,
        leave_out,
        parse_frame_range,
        select_frames,
    )
    from recon.clip.source import (
        BRIDGED_S,
        FramePoses,
        Source,
        View,
        at_rate,
        camera_poses,
        held,
        still_view,
        together,
        views_of,
        world_from_reference,
    )

__getattr__ = lazily(__name__, __file__)
