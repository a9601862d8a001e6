"""Write pages to read and to pass on: of one result, and of a batch. Each is one HTML file that fetches nothing.

Words, tables and numbers are those of the report, figures those of `recon.show.plots`; Jinja2 fills in `templates/` and
escapes all text from files and their names.
"""
