"""What may be missing, where, and when: effects, sites, supports, features."""
