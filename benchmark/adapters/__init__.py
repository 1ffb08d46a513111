"""Programs that take part in the benchmark through their command."""
