"""Speech: phones, visemes and their times."""
