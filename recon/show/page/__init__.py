"""Make HTML pages of a result, a batch, a comparison and an audit, which are single files that fetch nothing.

Sentences, tables and numbers come from the report, and figures from `recon.show.plots`. Jinja2 fills in `templates/`
and escapes all text from files and from their names.
"""
