"""Present results as reports, pages, figures, tables, overlays and playbacks."""
