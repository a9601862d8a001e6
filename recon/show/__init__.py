"""A result for people and other programs: report, page, figures, tables, overlay, playback."""
