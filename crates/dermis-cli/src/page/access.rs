//! Access control of the page. A request must name one of this server's hosts (otherwise a site could point its own
//! name here: DNS rebinding), must come from the page itself if the browser states an origin, and must carry the token
//! if there is one.

use std::fmt;
use std::hint::black_box;
use std::net::{IpAddr, SocketAddr};

use axum::http::uri::Authority;
use axum::http::{HeaderMap, StatusCode, Uri, header};

use super::PageError;

/// A secret that a page must present. It prints as dots, to keep it out of logs.
#[derive(Clone, PartialEq, Eq)]
pub struct Token(String);

/// Access rules of one server.
#[derive(Debug)]
pub(super) struct Access {
    token: Option<Token>,
    hosts: Vec<String>,
    any_address: bool,
    cookie: String,
}

/// Reason for rejecting a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Denial {
    Host,
    Origin,
    Token,
}

impl Token {
    /// Minimum length: 128 bits in hexadecimal.
    pub const LEAST_CHARACTERS: usize = 32;

    /// 128 random bits from the operating system, as 32 hexadecimal digits.
    ///
    /// # Errors
    /// [`PageError::Random`] if the system gives none.
    pub fn random() -> Result<Self, PageError> {
        let mut bytes = [0; 16];
        getrandom::fill(&mut bytes).map_err(|error| PageError::Random { reason: error.to_string() })?;
        Ok(Self(bytes.iter().map(|byte| format!("{byte:02x}")).collect()))
    }

    /// A token chosen by the user.
    ///
    /// # Errors
    /// [`PageError::TokenUnfit`] if it is shorter than [`Self::LEAST_CHARACTERS`] or has characters other than
    /// letters, digits, `-`, `_`.
    pub fn new(text: impl Into<String>) -> Result<Self, PageError> {
        let text = text.into();
        let is_fit = text.bytes().all(|byte| byte.is_ascii_alphanumeric() || byte == b'-' || byte == b'_');
        if !is_fit || text.len() < Self::LEAST_CHARACTERS {
            return Err(PageError::TokenUnfit { length: text.chars().count(), least: Self::LEAST_CHARACTERS });
        }
        Ok(Self(text))
    }

    /// The secret itself, for the printed address.
    pub fn as_str(&self) -> &str {
        &self.0
    }

    /// Compares in a time that doesn't depend on the content of either.
    fn is(&self, other: &str) -> bool {
        let (own, other) = (self.0.as_bytes(), other.as_bytes());
        let difference = own.iter().zip(other).fold(0, |all, (a, b)| black_box(all | (a ^ b)));
        own.len() == other.len() && difference == 0
    }
}

impl fmt::Debug for Token {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("Token(..)")
    }
}

impl Access {
    /// Rules for a server at `address` (with its real port), also known as `others`.
    ///
    /// # Errors
    /// [`PageError::TokenMissing`] beyond loopback without a token; [`PageError::HostUnfit`] for a host with scheme,
    /// port or path.
    pub(super) fn new(address: SocketAddr, token: Option<Token>, others: &[String]) -> Result<Self, PageError> {
        let ip = address.ip().to_canonical();
        if !ip.is_loopback() && token.is_none() {
            return Err(PageError::TokenMissing { address });
        }
        let mut hosts = vec!["localhost".to_owned(), "127.0.0.1".to_owned(), "[::1]".to_owned(), bracketed(ip)];
        for other in others {
            let is_fit = other.parse::<Authority>().is_ok_and(|authority| authority.host() == authority.as_str());
            if !is_fit {
                return Err(PageError::HostUnfit { host: other.clone() });
            }
            hosts.push(other.to_ascii_lowercase());
        }
        // A numeric host cannot be rebound to another server, so a server on all addresses needs no list of them.
        Ok(Self { token, hosts, any_address: ip.is_unspecified(), cookie: format!("dermis_token_{}", address.port()) })
    }

    /// Checks a request. Set `origin_required` for requests that browsers always send with an origin: WebSockets.
    pub(super) fn check(&self, headers: &HeaderMap, uri: &Uri, origin_required: bool) -> Result<(), Denial> {
        let authority = self.authority(headers, uri).ok_or(Denial::Host)?;
        let mut origins = headers.get_all(header::ORIGIN).iter();
        match (origins.next(), origins.next()) {
            (None, _) if !origin_required => {}
            (Some(origin), None) if is_same_origin(origin.as_bytes(), &authority) => {}
            _ => return Err(Denial::Origin),
        }
        match &self.token {
            Some(token) if !self.shown(headers, uri).any(|shown| token.is(shown)) => Err(Denial::Token),
            _ => Ok(()),
        }
    }

    /// If `uri` carries the token, the cookie that lets the page in from then on.
    pub(super) fn cookie(&self, uri: &Uri) -> Option<String> {
        let token = self.token.as_ref()?;
        let carries = in_query(uri).any(|shown| token.is(shown));
        carries.then(|| format!("{}={}; Path=/; HttpOnly; SameSite=Strict", self.cookie, token.0))
    }

    /// The single host that the request names, if it is one of this server's.
    fn authority(&self, headers: &HeaderMap, uri: &Uri) -> Option<Authority> {
        let mut hosts = headers.get_all(header::HOST).iter();
        let (host, None) = (hosts.next()?, hosts.next()) else { return None };
        let authority: Authority = host.to_str().ok()?.parse().ok()?;
        if authority.as_str().contains('@') || uri.authority().is_some_and(|other| *other != authority) {
            return None;
        }
        let name = authority.host().to_ascii_lowercase();
        let is_address = name.trim_start_matches('[').trim_end_matches(']').parse::<IpAddr>().is_ok();
        let is_ours = self.hosts.contains(&name) || (self.any_address && is_address);
        is_ours.then_some(authority)
    }

    /// All tokens in the request: in the address and in the page's cookie.
    fn shown<'a>(&'a self, headers: &'a HeaderMap, uri: &'a Uri) -> impl Iterator<Item = &'a str> {
        let cookies = headers.get_all(header::COOKIE).iter().filter_map(|value| value.to_str().ok());
        let ours = cookies.flat_map(|line| line.split(';')).filter_map(|pair| {
            let (name, value) = pair.trim().split_once('=')?;
            (name == self.cookie).then_some(value)
        });
        in_query(uri).chain(ours)
    }
}

impl Denial {
    pub(super) fn status(self) -> StatusCode {
        match self {
            Self::Host | Self::Origin => StatusCode::FORBIDDEN,
            Self::Token => StatusCode::UNAUTHORIZED,
        }
    }

    pub(super) fn explanation(self) -> &'static str {
        match self {
            Self::Host => {
                "Refused: this server does not answer to the host name in the address. Use the address that dermis printed, or start it with --allow-host NAME.\n"
            }
            Self::Origin => "Refused: the request does not come from this server's own page.\n",
            Self::Token => {
                "Refused: the token is missing or wrong. Open the whole address that dermis printed, including ?token= and the text after it.\n"
            }
        }
    }
}

/// An IP address as written in a URL.
pub(super) fn bracketed(ip: IpAddr) -> String {
    match ip {
        IpAddr::V4(ip) => ip.to_string(),
        IpAddr::V6(ip) => format!("[{ip}]"),
    }
}

fn in_query(uri: &Uri) -> impl Iterator<Item = &str> {
    uri.query().unwrap_or("").split('&').filter_map(|pair| pair.strip_prefix("token="))
}

fn is_same_origin(origin: &[u8], authority: &Authority) -> bool {
    let own = authority.as_str().as_bytes();
    // This server speaks plain HTTP, so a page loaded over HTTPS came from another.
    let named = origin.strip_prefix(b"http://");
    named.is_some_and(|named| named.eq_ignore_ascii_case(own))
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECRET: &str = "0123456789abcdef0123456789abcdef";

    fn check(access: &Access, uri: &str, headers: &[(header::HeaderName, &str)]) -> Result<(), Denial> {
        let map = headers.iter().map(|(name, value)| (name.clone(), value.parse().expect("a header"))).collect();
        access.check(&map, &uri.parse().expect("an address"), uri.starts_with("/ws"))
    }

    fn loopback() -> Access {
        Access::new(([127, 0, 0, 1], 8080).into(), None, &["lab-pc.local".into()]).expect("loopback needs no token")
    }

    #[test]
    fn only_known_hosts_are_answered() {
        let access = loopback();
        for host in ["127.0.0.1:8080", "localhost:8080", "LOCALHOST", "[::1]:8080", "lab-pc.local:9000"] {
            assert_eq!(check(&access, "/", &[(header::HOST, host)]), Ok(()), "{host}");
        }
        for host in
            ["evil.example", "localhost.evil.example", "127.0.0.1.evil.example:8080", "a@localhost", "10.0.0.1", ""]
        {
            assert_eq!(check(&access, "/", &[(header::HOST, host)]), Err(Denial::Host), "{host}");
        }
        assert_eq!(check(&access, "/", &[]), Err(Denial::Host));
        assert_eq!(check(&access, "http://evil.example/", &[(header::HOST, "localhost")]), Err(Denial::Host));
    }

    #[test]
    fn a_socket_must_come_from_the_page() {
        let access = loopback();
        let host = (header::HOST, "localhost:8080");
        assert_eq!(check(&access, "/ws", &[host.clone(), (header::ORIGIN, "http://localhost:8080")]), Ok(()));
        assert_eq!(check(&access, "/ws", std::slice::from_ref(&host)), Err(Denial::Origin));
        for origin in [
            "http://localhost:8081",
            "http://localhost",
            "null",
            "http://evil.example",
            "file://localhost:8080",
            "https://localhost:8080",
        ] {
            assert_eq!(
                check(&access, "/ws", &[host.clone(), (header::ORIGIN, origin)]),
                Err(Denial::Origin),
                "{origin}"
            );
        }
    }

    #[test]
    fn beyond_loopback_a_token_is_required_and_compared_whole() {
        let everywhere = SocketAddr::from(([0, 0, 0, 0], 80));
        assert!(matches!(Access::new(everywhere, None, &[]), Err(PageError::TokenMissing { .. })));
        let access = Access::new(everywhere, Some(Token::new(SECRET).expect("fits")), &[]).expect("has a token");
        let host = (header::HOST, "192.168.1.7");
        assert_eq!(check(&access, &format!("/?token={SECRET}"), std::slice::from_ref(&host)), Ok(()));
        let cookie = format!("other=1; dermis_token_80={SECRET}");
        assert_eq!(check(&access, "/", &[host.clone(), (header::COOKIE, &cookie)]), Ok(()));
        for wrong in
            ["/", "/?token=", "/?token=0123456789abcdef0123456789abcdee", "/?token=0123456789abcdef", "/?xtoken=1"]
        {
            assert_eq!(check(&access, wrong, std::slice::from_ref(&host)), Err(Denial::Token), "{wrong}");
        }
        let longer = format!("/?token={SECRET}0");
        assert_eq!(check(&access, &longer, &[host]), Err(Denial::Token));
    }

    #[test]
    fn tokens_are_long_random_and_unprinted() {
        let (one, two) = (Token::random().expect("random"), Token::random().expect("random"));
        assert_ne!(one, two);
        assert_eq!(one.as_str().len(), Token::LEAST_CHARACTERS);
        assert!(!format!("{one:?}").contains(one.as_str()));
        assert!(matches!(Token::new("short"), Err(PageError::TokenUnfit { length: 5, .. })));
        assert!(Token::new("a".repeat(40) + "&b").is_err());
    }

    #[test]
    fn a_host_with_a_scheme_or_port_is_refused() {
        for host in ["http://lab", "lab:80", "lab/x", ""] {
            let made = Access::new(([127, 0, 0, 1], 1).into(), None, &[host.into()]);
            assert!(matches!(made, Err(PageError::HostUnfit { .. })), "{host}");
        }
    }
}
