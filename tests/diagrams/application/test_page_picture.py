"""A picture of a page is what a browser shows, and none where there is no browser."""

import io

import pytest
from browser import chromium
from PIL import Image

from notebooks.pages import page_picture


@pytest.mark.skipif(
    chromium() is None, reason="no chromium to open pages in; on Debian: apt-get install chromium"
)
def test_a_page_is_shown_as_it_is_after_its_script(tmp_path):
    page = tmp_path / "red page.html"
    page.write_text("<body><script>document.body.style.background = 'rgb(200, 10, 20)'</script>")
    picture = Image.open(io.BytesIO(page_picture(page, 120, 90))).convert("RGB")
    assert picture.size == (120, 90)
    assert picture.getpixel((60, 45)) == (200, 10, 20)


def test_without_a_browser_there_is_none(tmp_path, monkeypatch):
    page = tmp_path / "page.html"
    page.write_text("<body>")
    monkeypatch.setenv("PATH", str(tmp_path))
    assert page_picture(page) is None


def test_a_page_that_is_missing_is_told(tmp_path):
    with pytest.raises(FileNotFoundError):
        page_picture(tmp_path / "none.html")
