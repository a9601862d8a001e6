"""What every room uses: errors, whole-or-nothing files, documents, interrupts, progress."""
