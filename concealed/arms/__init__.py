"""Arms on servos whose model the user has as an MJCF: the robot itself leaves out nothing, and is made otherwise."""
