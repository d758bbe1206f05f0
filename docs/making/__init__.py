"""What the site has beside the written pages: made from the code itself when it is built."""
