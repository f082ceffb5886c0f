"""Who gets the page: this machine, or who knows the token; and never more than read-only."""

from __future__ import annotations

import re
from http import HTTPStatus

import pytest

from canest.core.errors import UsageError
from canest.serve.access import Access
from canest.serve.requests import Request

TOKEN = "0123456789abcdef0123"
PORT = 8080


def request(path="/", query=None, **headers):
    return Request("GET", path, query or {}, {k.replace("_", "-"): v for k, v in headers.items()})


def status(access, asked):
    refusal = access.refusal(asked)
    return HTTPStatus.OK if refusal is None else refusal.status


@pytest.mark.parametrize("host", ["127.0.0.1:8080", "localhost:8080", "[::1]:8080", "localhost"])
def test_this_machine_needs_no_token(host):
    assert status(Access("127.0.0.1", None, PORT), request(host=host)) == 200


@pytest.mark.parametrize("host", ["evil.example:8080", "", "127.0.0.1.evil.example", "[::2]"])
def test_a_page_of_another_site_cannot_reach_us_by_a_name_of_its_own(host):
    assert status(Access("127.0.0.1", None, PORT), request(host=host)) == 403


@pytest.mark.parametrize("address", ["0.0.0.0", "::", "192.168.1.7"])
def test_an_address_that_others_reach_needs_a_token(address):
    with pytest.raises(UsageError, match="everybody in the network could read"):
        Access(address, None, PORT)
    Access(address, TOKEN, PORT)


def test_an_address_that_is_none_is_refused():
    with pytest.raises(UsageError, match="is no address, found 'truck'"):
        Access("truck", None, PORT)


@pytest.mark.parametrize("token", ["", "short", "0123456789 abcdef", "päßwörter-sind-lang"])
def test_a_token_that_is_short_or_no_token_is_refused(token):
    with pytest.raises(UsageError, match="cannot serve as a token"):
        Access("0.0.0.0", token, PORT)


def test_the_token_is_given_once_and_kept_in_a_cookie():
    access = Access("0.0.0.0", TOKEN, PORT)
    assert status(access, request()) == 401
    answer = access.refusal(request(query={"token": [TOKEN]}))
    headers = dict(answer.headers)
    assert answer.status == 303 and headers["Location"] == "/"
    assert "HttpOnly" in headers["Set-Cookie"] and "SameSite=Lax" in headers["Set-Cookie"]
    assert int(re.search(r"Max-Age=(\d+)", headers["Set-Cookie"])[1]) > 300 * 86_400
    cookie = headers["Set-Cookie"].split(";")[0]
    assert status(access, request(cookie=f"other=1; {cookie}")) == 200
    assert status(access, request(authorization=f"Bearer {TOKEN}")) == 200


@pytest.mark.parametrize(
    "asked",
    [
        request(query={"token": ["0123456789abcdef0124"]}),
        request(cookie=f"canest_token_{PORT}=wrong"),
        request(authorization="Bearer wrong"),
        request(authorization=f"Basic {TOKEN}"),
        request(authorization="Bearer päßwort"),
    ],
)
def test_a_wrong_token_gets_nothing(asked):
    assert status(Access("0.0.0.0", TOKEN, PORT), asked) == 401


def test_two_pages_of_one_host_keep_a_cookie_each():
    other = "fedcba98765432100123"
    first, second = Access("0.0.0.0", TOKEN, 8080), Access("0.0.0.0", other, 8081)
    kept = {}  # as a browser does: by name, whatever the port
    for access, token in ((first, TOKEN), (second, other)):
        answer = access.refusal(request(query={"token": [token]}))
        name, _, value = dict(answer.headers)["Set-Cookie"].split(";")[0].partition("=")
        kept[name] = value
    cookie = "; ".join(f"{name}={value}" for name, value in kept.items())
    assert [status(access, request(cookie=cookie)) for access in (first, second)] == [200, 200]
