"""What every stage shares: frames, samples, roles, gates, units, errors. Imports nothing else of canest."""
