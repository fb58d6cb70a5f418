"""The model as an observer: states, with standard deviations, that were never measured."""
