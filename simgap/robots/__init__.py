"""What a policy is run on: the virtual Spot and who teleoperates it; a real robot comes in by the same functions."""
