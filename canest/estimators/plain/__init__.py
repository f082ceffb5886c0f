"""The papers' recursions for a regression of your own, without vehicle, gates or bounds."""
