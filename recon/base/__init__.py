"""General tools: errors, files that are written whole or not at all, documents, interrupts, progress."""
