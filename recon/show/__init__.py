"""Present results to people and other programs: report, page, figures, tables, overlay and playback."""
