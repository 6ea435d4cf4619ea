"""Controllers: trained networks that answer with optimal grasps."""
