"""Maximum likelihood: of a model, of hypotheses on top of it, from all their starts."""
