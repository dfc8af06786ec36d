"""From recordings and a simulator to what the simulator leaves out."""
