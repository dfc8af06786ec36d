"""Which effects, where and when: one more at a time, and each against its alternatives."""
