"""Define the sections of report.json and of the summary."""
