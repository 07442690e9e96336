"""What an identification returns, and how it is printed, saved and used to predict."""
