"""Define the file names of pages, and the HTML element by which recon recognises its own pages."""

from __future__ import annotations

PAGE, SUMMARY_PAGE, COMPARE_PAGE = "report.html", "summary.html", "compare.html"
"""File names of the page of a result, of a batch, and of a comparison, in their folders."""
GENERATED = '<meta name="generator" content="recon">'
"""HTML element in the head of every page made by recon."""
