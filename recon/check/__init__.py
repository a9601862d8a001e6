"""Diagnoses of an input or a fit."""
