"""What a frame says about the preset: findings with a remedy, and proposals with their evidence."""
