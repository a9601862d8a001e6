"""Compute the sections of report.json, and write the summary's lines from them."""
