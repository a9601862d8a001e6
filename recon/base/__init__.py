"""Provide what all of recon uses: errors, files written whole or not at all, documents, interrupts, progress."""
