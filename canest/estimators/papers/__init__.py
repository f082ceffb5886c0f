"""The methods of the three papers."""
