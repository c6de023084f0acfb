"""What is said when: phones, visemes and their times."""
