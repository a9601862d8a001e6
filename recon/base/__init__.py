"""Tools for all of recon: errors, files written whole or not at all, documents, interrupts, progress."""
