"""Provide what every room uses: errors, files written whole or not at all, documents, interrupts, progress."""
