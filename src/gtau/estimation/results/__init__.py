"""Results of an identification: printed, saved, loaded, and used to predict."""
