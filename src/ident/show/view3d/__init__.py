"""A mechanism moving in 3-D, drawn by `charts/scene.js`."""
