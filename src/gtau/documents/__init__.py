"""How every file that people write is read, checked and refused."""
