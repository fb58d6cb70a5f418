"""Every stage in order: records to signals to candidates to one model."""
