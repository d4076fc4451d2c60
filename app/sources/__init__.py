"""Live cameras in the application: choosing them and their settings."""
