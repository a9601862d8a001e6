"""Define general tools for errors, files that are written whole or not at all, documents, interrupts and progress."""
