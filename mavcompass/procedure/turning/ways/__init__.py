"""The ways in which vehicles turn, one file each; profiles in `params/vehicles` name them."""
