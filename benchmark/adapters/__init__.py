"""Programs that enter the benchmark through their command."""
