//! What a failed TLS connection means, and what to do about it.

/// What a reason of TLS means, and what to do, with the fleet's authority at hand or without; `None` for any other reason.
pub(crate) fn explain(reason: &str, knows_authority: bool) -> Option<&'static str> {
    if reason.contains("invalid peer certificate: UnknownIssuer") && !knows_authority {
        return Some("its certificate is of a fleet: give --credentials");
    }
    let another = "its certificate is of another authority than the ca.pem given here";
    let early = "its certificate is not valid yet: is this clock behind?";
    let stranger = "it knows another authority than that of the certificate given here";
    let known = [
        ("NotValidForName", "its certificate does not name this host: issue it with --host"),
        ("not valid for name", "its certificate does not name this host: issue it with --host"),
        ("invalid peer certificate: UnknownIssuer", another),
        ("invalid peer certificate: BadSignature", another),
        ("invalid peer certificate: certificate expired", "its certificate has expired, or this clock is ahead"),
        ("invalid peer certificate: Expired", "its certificate has expired, or this clock is ahead"),
        ("invalid peer certificate: certificate not valid yet", early),
        ("alert: CertificateExpired", "it says that the certificate given here has expired; is its clock right?"),
        ("alert: CertificateRequired", "it wants a certificate: give --credentials"),
        ("alert: UnknownCA", stranger),
        ("alert: DecryptError", stranger),
        ("alert: BadCertificate", "it refuses the certificate given here"),
    ];
    known.iter().find(|(words, _)| reason.contains(words)).map(|(_, meaning)| *meaning)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_tls_says_is_said_in_words() {
        let said = "Can not create a new TLS link bound to IpAddress(V4(Ipv4Addr([127, 0, 0, 1]))): invalid peer \
                    certificate: certificate not valid for name \"127.0.0.1\"; certificate is only valid for DnsName at x";
        let says = |reason: &str, knows: bool| explain(reason, knows).unwrap_or_default();
        assert!(says(said, true).contains("--host"));
        assert!(says("received fatal alert: CertificateRequired at io", true).contains("--credentials"));
        let stranger = "bound to x: invalid peer certificate: UnknownIssuer at io";
        assert!(says(stranger, true).contains("another authority") && says(stranger, false).contains("--credentials"));
        assert_eq!(explain("Connection refused (os error 111) at /io/x.rs:3", true), None);
    }
}
