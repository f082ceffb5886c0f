"""The classes behind `canest.api`: what its functions take and give back."""
