"""Heights: bare earth, shape of surfaces, means over regions, and the mixture that tells roofs from trees."""
