"""Effects that change the noise and not the mean."""
