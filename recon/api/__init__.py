"""What Python users and several commands call; nothing here prints."""
