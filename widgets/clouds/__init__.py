"""3D views of point clouds, drawn with OpenGL or by the processor."""
