"""Assets that ship with wrod: URDF, built-in patterns, the trained controller."""
