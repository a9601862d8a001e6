"""Workflows: each file is a readable list of calls."""
