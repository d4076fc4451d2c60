"""3D views of point clouds, drawn by the processor."""
