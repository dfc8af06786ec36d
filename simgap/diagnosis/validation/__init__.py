"""What held-out sessions say, and the verdict."""
