"""A playback and what was written later to go with it, as one file.

The viewer puts files of one recording together itself, but takes the layout of whichever it happens to read first.
"""

from __future__ import annotations

from pathlib import Path

from recon.show.recording import recording
from recon.show.view.stored import Part


def put_together(path: Path, playback: Path, plots: Path | None, video: Path | None) -> list[Path]:
    """Write it, and return the files that belong to another recording, such as an earlier fit's, and are left out.

    plots, video: as `recon.show.view.added` and `recon.show.view.video` wrote them. Raises InputError for a file of
    another kind.
    """
    whole = Part.read(playback)
    parts = {part: Part.read(part) for part in (plots, video) if part is not None}
    own = {part: content for part, content in parts.items() if content.id == whole.id}
    layout = own[plots].layout if plots in own else whole.layout
    with recording(path, layout, part_of=whole.id) as stream:
        for content in (whole, *own.values()):
            stream.send_chunks(content.data)
    return [part for part in parts if part not in own]
