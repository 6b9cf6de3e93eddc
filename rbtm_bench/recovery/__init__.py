"""What follows a registration that is not believed: other starts, before the guess is kept."""
