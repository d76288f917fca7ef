//! A pull parser for JSON over a buffer that may end too early.
//!
//! It reads numbers exactly (the nearest `f64`), knows where it stands, and takes `NaN` and `Infinity` as numbers that
//! are not finite: Python writes them, and one such coordinate must cost one feature, not the file.

use std::borrow::Cow;

use crate::diag::Diagnostic;

/// Why parsing stopped.
#[derive(Debug)]
pub enum Stop {
    /// The buffer ends in the middle: with more text it may go on.
    End,
    Bad {
        at: usize,
        what: String,
    },
    /// Not about the text.
    Fail(Box<Diagnostic>),
}

impl From<Box<Diagnostic>> for Stop {
    fn from(d: Box<Diagnostic>) -> Self {
        Self::Fail(d)
    }
}

pub type Parsed<T> = Result<T, Stop>;

/// A value that is not a list or an object, or the text of one that is.
#[derive(Clone, Debug, PartialEq)]
pub enum Scalar<'a> {
    Null,
    Bool(bool),
    /// The number, and how it was written.
    Number(f64, &'a str),
    Text(Cow<'a, str>),
    /// A list or an object as it stands there.
    Nested(&'a str),
}

/// A place in a buffer.
pub struct Json<'a> {
    text: &'a [u8],
    pub at: usize,
}

/// Lists and objects nested deeper than this are refused.
const DEEPEST: u32 = 100;

/// Powers of ten that an `f64` holds exactly.
const TENS: [f64; 23] = [
    1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15, 1e16, 1e17, 1e18, 1e19, 1e20,
    1e21, 1e22,
];

impl<'a> Json<'a> {
    pub fn new(text: &'a [u8], at: usize) -> Self {
        Self { text, at }
    }

    /// Line breaks since `from`.
    pub fn lines(&self, from: usize) -> u64 {
        self.text[from..self.at].iter().map(|&b| u64::from(b == b'\n')).sum()
    }

    pub fn bad<T>(&self, what: impl Into<String>) -> Parsed<T> {
        Err(Stop::Bad { at: self.at, what: what.into() })
    }

    /// The next byte that is not white space, not taken.
    #[inline]
    pub fn peek(&mut self) -> Parsed<u8> {
        loop {
            match self.text.get(self.at) {
                Some(b' ' | b'\n' | b'\r' | b'\t') => self.at += 1,
                Some(&b) => return Ok(b),
                None => return Err(Stop::End),
            }
        }
    }

    /// Takes `b` if it comes next.
    #[inline]
    pub fn take(&mut self, b: u8) -> Parsed<bool> {
        let is = self.peek()? == b;
        self.at += usize::from(is);
        Ok(is)
    }

    #[inline]
    pub fn expect(&mut self, b: u8) -> Parsed<()> {
        if self.take(b)? { Ok(()) } else { self.bad(format!("expected `{}`", b as char)) }
    }

    /// After a member of a list or an object: true where another follows, false after `close`.
    #[inline]
    pub fn goes_on(&mut self, close: u8) -> Parsed<bool> {
        match self.peek()? {
            b',' => {
                self.at += 1;
                Ok(true)
            }
            b if b == close => {
                self.at += 1;
                Ok(false)
            }
            _ => self.bad(format!("expected `,` or `{}`", close as char)),
        }
    }

    /// Calls `each` with every key; it takes the value.
    pub fn object(&mut self, mut each: impl FnMut(&mut Self, Cow<'a, str>) -> Parsed<()>) -> Parsed<()> {
        self.expect(b'{')?;
        if self.take(b'}')? {
            return Ok(());
        }
        loop {
            let key = self.key()?;
            each(self, key)?;
            if !self.goes_on(b'}')? {
                return Ok(());
            }
        }
    }

    /// A key and its colon.
    #[inline]
    pub fn key(&mut self) -> Parsed<Cow<'a, str>> {
        let key = self.string()?;
        self.expect(b':')?;
        Ok(key)
    }

    /// Calls `each` for every value of a list; it takes the value.
    pub fn list(&mut self, mut each: impl FnMut(&mut Self) -> Parsed<()>) -> Parsed<()> {
        self.expect(b'[')?;
        if self.take(b']')? {
            return Ok(());
        }
        loop {
            each(self)?;
            if !self.goes_on(b']')? {
                return Ok(());
            }
        }
    }

    #[inline]
    pub fn string(&mut self) -> Parsed<Cow<'a, str>> {
        self.expect(b'"')?;
        let start = self.at;
        let rest = &self.text[start..];
        let Some(n) = rest.iter().position(|&b| b == b'"' || b == b'\\' || b < b' ') else { return Err(Stop::End) };
        if rest[n] == b'"' {
            self.at = start + n + 1;
            return self.utf8(start, &rest[..n]).map(Cow::Borrowed);
        }
        self.at = start + n;
        self.escaped(start).map(Cow::Owned)
    }

    fn utf8(&self, at: usize, bytes: &'a [u8]) -> Parsed<&'a str> {
        std::str::from_utf8(bytes).map_err(|_| Stop::Bad { at, what: "text that is not UTF-8".into() })
    }

    /// A string with escapes; `self.at` is at the first byte that needs care.
    fn escaped(&mut self, start: usize) -> Parsed<String> {
        let mut out = self.text[start..self.at].to_vec();
        loop {
            let b = *self.text.get(self.at).ok_or(Stop::End)?;
            self.at += 1;
            match b {
                b'"' => {
                    return String::from_utf8(out)
                        .map_err(|_| Stop::Bad { at: start, what: "text that is not UTF-8".into() });
                }
                b'\\' => {
                    let e = *self.text.get(self.at).ok_or(Stop::End)?;
                    self.at += 1;
                    match e {
                        b'"' | b'\\' | b'/' => out.push(e),
                        b'b' => out.push(8),
                        b'f' => out.push(12),
                        b'n' => out.push(b'\n'),
                        b'r' => out.push(b'\r'),
                        b't' => out.push(b'\t'),
                        b'u' => {
                            let c = self.code_point()?;
                            out.extend(c.encode_utf8(&mut [0; 4]).as_bytes());
                        }
                        _ => return self.bad("an unknown escape in a text"),
                    }
                }
                b if b < b' ' => {
                    self.at -= 1;
                    return self.bad("a line break or control character inside a text");
                }
                b => out.push(b),
            }
        }
    }

    /// Four hexadecimal digits, or two such halves; half a pair alone becomes the replacement character.
    fn code_point(&mut self) -> Parsed<char> {
        let hex = |json: &mut Self| {
            let digits = json.text.get(json.at..json.at + 4).ok_or(Stop::End)?;
            let text = std::str::from_utf8(digits).ok().filter(|t| t.bytes().all(|b| b.is_ascii_hexdigit()));
            let Some(text) = text else { return json.bad("an unknown escape in a text") };
            json.at += 4;
            Ok(u32::from_str_radix(text, 16).expect("hexadecimal digits"))
        };
        let high = hex(self)?;
        if !(0xd800..0xdc00).contains(&high) {
            return Ok(char::from_u32(high).unwrap_or(char::REPLACEMENT_CHARACTER));
        }
        let rest = &self.text[self.at..];
        if rest.len() < 2 && b"\\u".starts_with(rest) {
            return Err(Stop::End);
        }
        if !rest.starts_with(b"\\u") {
            return Ok(char::REPLACEMENT_CHARACTER);
        }
        let before = self.at;
        self.at += 2;
        let low = hex(self)?;
        if !(0xdc00..0xe000).contains(&low) {
            self.at = before;
            return Ok(char::REPLACEMENT_CHARACTER);
        }
        Ok(char::from_u32(0x10000 + ((high - 0xd800) << 10) + (low - 0xdc00)).unwrap_or(char::REPLACEMENT_CHARACTER))
    }

    /// A number comes next.
    #[inline]
    pub fn at_number(&mut self) -> Parsed<bool> {
        Ok(matches!(self.peek()?, b'0'..=b'9' | b'-' | b'N' | b'I'))
    }

    #[inline]
    pub fn number(&mut self) -> Parsed<f64> {
        self.peek()?;
        let start = self.at;
        let text = &self.text[start..];
        let negative = text.first() == Some(&b'-');
        let mut i = usize::from(negative);
        let (mut mantissa, mut point) = (0u64, None);
        // Up to 15 digits without an exponent: two exact numbers, one rounding.
        let digits = loop {
            match text.get(i) {
                Some(&b @ b'0'..=b'9') => {
                    mantissa = mantissa.wrapping_mul(10).wrapping_add(u64::from(b - b'0'));
                    i += 1;
                }
                Some(b'.') if point.is_none() => {
                    point = Some(i);
                    i += 1;
                }
                Some(b',' | b']' | b'}' | b' ' | b'\n' | b'\r' | b'\t') => {
                    break i - usize::from(negative) - usize::from(point.is_some());
                }
                Some(_) => return self.long_number(),
                None => return Err(Stop::End),
            }
        };
        let decimals = point.map_or(0, |p| i - p - 1);
        if digits == 0 || digits > 15 || point == Some(i - 1) || text[usize::from(negative)] == b'.' {
            return self.long_number();
        }
        self.at = start + i;
        let value = mantissa as f64 / TENS[decimals];
        Ok(if negative { -value } else { value })
    }

    #[cold]
    fn long_number(&mut self) -> Parsed<f64> {
        let text = &self.text[self.at..];
        let end = text.iter().position(|b| !matches!(b, b'0'..=b'9' | b'+' | b'-' | b'.' | b'e' | b'E'));
        let end = if let Some(end) = end { end } else { return Err(Stop::End) };
        let sign = usize::from(text[0] == b'-');
        for name in ["NaN", "Infinity"] {
            let n = sign + name.len();
            if text.len() < n && name.as_bytes().starts_with(&text[sign..]) {
                return Err(Stop::End);
            }
            if text.len() >= n && &text[sign..n] == name.as_bytes() {
                self.at += n;
                return Ok(f64::NAN);
            }
        }
        let written = std::str::from_utf8(&text[..end]).unwrap_or_default();
        let sound = text[sign].is_ascii_digit() && text[end - 1].is_ascii_digit() && !written.contains(".e");
        match written.parse::<f64>() {
            Ok(v) if sound => {
                self.at += end;
                Ok(v)
            }
            _ => self.bad("expected a number"),
        }
    }

    /// Any value.
    pub fn scalar(&mut self) -> Parsed<Scalar<'a>> {
        match self.peek()? {
            b'"' => self.string().map(Scalar::Text),
            b'{' | b'[' => self.raw().map(Scalar::Nested),
            b't' => self.word("true").map(|()| Scalar::Bool(true)),
            b'f' => self.word("false").map(|()| Scalar::Bool(false)),
            b'n' => self.word("null").map(|()| Scalar::Null),
            _ => {
                let start = self.at;
                let value = self.number()?;
                let written = &self.text[start..self.at];
                Ok(Scalar::Number(value, self.utf8(start, written)?))
            }
        }
    }

    fn word(&mut self, word: &str) -> Parsed<()> {
        let rest = &self.text[self.at..];
        if rest.starts_with(word.as_bytes()) {
            self.at += word.len();
            return Ok(());
        }
        if word.as_bytes().starts_with(rest) { Err(Stop::End) } else { self.bad("expected a value") }
    }

    /// Passes over any value.
    pub fn skip(&mut self) -> Parsed<()> {
        self.skip_below(DEEPEST)
    }

    fn skip_below(&mut self, depth: u32) -> Parsed<()> {
        match self.peek()? {
            b'{' | b'[' if depth == 0 => self.bad("lists or objects nested too deep"),
            b'{' => self.object(|json, _| json.skip_below(depth - 1)),
            b'[' => self.list(|json| json.skip_below(depth - 1)),
            b'"' => self.string().map(drop),
            b't' => self.word("true"),
            b'f' => self.word("false"),
            b'n' => self.word("null"),
            _ => self.number().map(drop),
        }
    }

    /// The text of any value.
    pub fn raw(&mut self) -> Parsed<&'a str> {
        self.peek()?;
        let start = self.at;
        self.skip()?;
        let written = &self.text[start..self.at];
        self.utf8(start, written)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn number(text: &str) -> f64 {
        Json::new(text.as_bytes(), 0).number().unwrap()
    }

    #[test]
    fn numbers_are_the_nearest() {
        for t in ["0", "-0", "139.6625134", "35.6320086", "123456789012345", "0.1", "1e3", "1E-3", "-2.5e+2", "1e300"] {
            assert_eq!(number(&format!("{t} ")).to_bits(), t.parse::<f64>().unwrap().to_bits(), "{t}");
        }
        for t in ["9007199254740993", "0.30000000000000004", "139.66251340000001234", "1e400"] {
            assert_eq!(number(&format!("{t},")), t.parse::<f64>().unwrap(), "{t}");
        }
        assert!(number("NaN]").is_nan() && number("-Infinity]").is_nan());
        for t in ["-", ".5", "1.", "1.2.3", "+1", "1e", "abc", "--1", "1.e5"] {
            assert!(matches!(Json::new(format!("{t} ").as_bytes(), 0).number(), Err(Stop::Bad { .. })), "{t}");
        }
    }

    #[test]
    fn texts() {
        let text = |t: &str| Json::new(t.as_bytes(), 0).string().map(Cow::into_owned);
        assert_eq!(text(r#""plain""#).unwrap(), "plain");
        assert_eq!(text(r#""a\"b\\\/\n\u00e4\ud83d\ude00\ud83dx""#).unwrap(), "a\"b\\/\nä😀\u{fffd}x");
        assert!(matches!(text("\"a\nb\""), Err(Stop::Bad { .. })));
        assert!(matches!(text(r#""\q""#), Err(Stop::Bad { .. })));
        let broken = b"\"\xff\"";
        assert!(matches!(Json::new(broken, 0).string(), Err(Stop::Bad { .. })));
    }

    #[test]
    fn every_cut_asks_for_more() {
        let whole = r#"{"a": [1, -2.5e3, "x\u00e4\ud83d\ude00", true, false, null, {"b": {}}, []], "c": NaN} "#;
        assert!(Json::new(whole.as_bytes(), 0).skip().is_ok());
        for cut in 0..whole.len() - 1 {
            assert!(matches!(Json::new(&whole.as_bytes()[..cut], 0).skip(), Err(Stop::End)), "{cut}");
        }
    }

    #[test]
    fn depth_is_bounded() {
        assert!(matches!(Json::new("[".repeat(1_000_000).as_bytes(), 0).skip(), Err(Stop::Bad { .. })));
    }
}
