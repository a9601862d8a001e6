"""Write pages of a result, a batch, a comparison and an audit. Each is one HTML file that fetches nothing.

Texts, tables and numbers are those of the report, figures those of `recon.show.plots`. Jinja2 fills in `templates/` and
escapes all text from files and from their names.
"""
