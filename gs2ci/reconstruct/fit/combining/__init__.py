"""What is made of several fits and candidates for the views."""
