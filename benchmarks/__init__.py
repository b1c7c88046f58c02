"""Speed against other libraries; never imported by the product."""
