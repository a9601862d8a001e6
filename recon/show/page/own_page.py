"""Define the names of the pages' files, and the mark that identifies pages made by recon."""

from __future__ import annotations

PAGE, SUMMARY_PAGE, COMPARE_PAGE = "report.html", "summary.html", "compare.html"
"""Names of the page in the folder of a result, in that of a batch, and in that of a comparison."""
GENERATED = '<meta name="generator" content="recon">'
"""Mark by which recon recognises its own pages."""
