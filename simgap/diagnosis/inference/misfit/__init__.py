"""What a model leaves: laws that are not exact, innovations that can be predicted, pushes without a name."""
