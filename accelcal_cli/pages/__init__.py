"""Pages for people: self-contained HTML made from our reports, with figures drawn here as inline SVG."""
