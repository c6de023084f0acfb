"""What a person should look at in a solve: the verdict on it, and the moments to review first."""
