"""What readers of page-wise files share: blocks, timelines, problems."""
