"""Pages to look at and to pass on: of one result, and of a batch. Each is one HTML file that fetches nothing.

The words, tables and numbers are the report's, the figures those of `recon.plots`, the frame around them that of
`templates/`, filled in by Jinja2, which escapes whatever comes from a file or its name.
"""

PAGE, SUMMARY_PAGE = "report.html", "summary.html"
"""In the folder of a result, and in that of a batch."""
