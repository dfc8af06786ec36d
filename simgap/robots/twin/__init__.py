"""A twin: a robot that stands in for a recorded one. It moves as a model fitted to all of its recordings says, with the
durations of rows and the departures from the model that were recorded."""
