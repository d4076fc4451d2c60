"""Are the cameras well? Depth quality, delay between both, and whether one disturbs the other."""
