"""Define the file names of pages and playbacks, and the HTML element by which recon recognises its own pages."""

from __future__ import annotations

PAGE, SUMMARY_PAGE, COMPARE_PAGE = "report.html", "summary.html", "compare.html"
"""File names of the page of a result, of a batch, and of a comparison, in their folders."""
SUMMARY = "summary.csv"
"""File name of the table of a batch."""
PLAYBACK = "motion.rrd"
VIDEO_PLAYBACK = "playback.rrd"
"""File name of the playback with the video, which `recon run` writes and `recon view` then opens."""
GENERATED = '<meta name="generator" content="recon">'
"""HTML element in the head of every page made by recon."""
