"""Reading: experiment files, their columns and units, and logs of any format; drafts of these files from logs."""
