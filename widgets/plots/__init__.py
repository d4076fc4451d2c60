"""Plots of residuals, differences and coverage."""
