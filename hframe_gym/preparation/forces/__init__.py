"""Forces that the measured motion requires, and the directions of the drives that follow from them."""
