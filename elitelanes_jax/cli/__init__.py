"""The command `elitelanes`."""
