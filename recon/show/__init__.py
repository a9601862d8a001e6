"""Present a result to people and other programs: report, page, figures, tables, overlay, playback."""
