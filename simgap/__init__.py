"""Learn a robot's dynamics from few recordings, and say what its simulator leaves out."""
