"""A robot that is added on the page: described, checked and drawn before anything is stored."""
