"""What readers of page-wise files share: pages and their times, rows, problems."""
