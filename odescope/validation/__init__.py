"""A model on data that it has not seen: fits, valid times, where the data leave its domain."""
