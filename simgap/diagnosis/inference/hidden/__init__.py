"""Play or a spring between motor and link: rivals of what was found at a joint of an engine."""
