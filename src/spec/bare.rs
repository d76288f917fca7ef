//! A pipeline's text without what means nothing: two texts that are alike bare are the same pipeline. It costs a tenth of
//! parsing, so that a rerun after an edited comment is as good as one with nothing to do.

/// Without comments, blank lines, and blanks at both ends of lines; all else as it stands, strings to the byte. None
/// where it is not certain what is a comment, or one holds what no comment may.
pub fn bare(text: &str) -> Option<String> {
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    let bytes = text.as_bytes();
    let mut out = String::with_capacity(text.len());
    // Where the line starts.
    let mut line = 0;
    let mut at = 0;
    loop {
        // What is plain, in one piece.
        let plain = bytes[at..].iter().position(|b| b"\n#\"'\r".contains(b)).map_or(bytes.len(), |n| at + n);
        let piece = &text[at..plain];
        out.push_str(if out.len() == line { piece.trim_start_matches([' ', '\t']) } else { piece });
        at = plain;
        match bytes.get(at) {
            Some(b'"' | b'\'') => {
                let end = at + string_end(&bytes[at..])?;
                out.push_str(&text[at..end]);
                at = end;
                continue;
            }
            Some(b'#') => {
                let length = bytes[at..].iter().position(|b| b"\n\r".contains(b)).unwrap_or(bytes.len() - at);
                if bytes[at..at + length].iter().any(|&b| b == 0x7f || b < b' ' && b != b'\t') {
                    return None;
                }
                at += length;
            }
            _ => {}
        }
        if bytes.get(at) == Some(&b'\r') {
            at += 1;
            if bytes.get(at) != Some(&b'\n') {
                return None;
            }
        }
        // The line's end. A string ends with a quote, so that nothing of it goes.
        out.truncate(line + out[line..].trim_end_matches([' ', '\t']).len());
        if out.len() > line {
            out.push('\n');
            line = out.len();
        }
        if at == bytes.len() {
            return Some(out);
        }
        at += 1;
    }
}

/// Bytes of the string that starts here, quotes included.
fn string_end(bytes: &[u8]) -> Option<usize> {
    let quote = bytes[0];
    let many = bytes.starts_with(&[quote; 3]);
    let close: &[u8] = if many { &[quote; 3] } else { &[quote] };
    let mut at = close.len();
    loop {
        match bytes.get(at)? {
            b'\\' if quote == b'"' => at += 2,
            b'\n' if !many => return None,
            _ if bytes[at..].starts_with(close) => break,
            _ => at += 1,
        }
    }
    at += close.len();
    // Two more quotes may belong to it.
    let more = bytes[at..].iter().take(2).take_while(|&&b| many && b == quote).count();
    Some(at + more)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn comments_and_blanks_go_strings_stay() {
        let same = [
            "a = 1\n[b]\nc = [\n1,\n2 ]\n",
            "# x\r\n\r\na = 1 # y\r\n\t[b]\t\r\n# \"\n c = [ # '\n1,\n  2 ] \n# end",
            "\u{feff}a = 1\n[b]\nc = [\n1,\n2 ]",
        ];
        same.iter().for_each(|t| assert_eq!(bare(t).as_deref(), Some(same[0]), "{t}"));
        for verbatim in [
            "a = \"# \\\" # \"\n",
            "a = '# \\'\n",
            "a = \"\"\"\n # \n\\\"\"\" \" \"\"\"\"\" \n",
            "a = '''\n# \n'''\n",
            "a = \"\"\"x\"\"\"\"\n",
            "a = '''x''''\n",
            "a = [ ' ', \"\"\"\n \"\"\" ]\n",
            "a = ''\n",
        ] {
            let text = bare(&format!("{verbatim}# '\" \n")).unwrap();
            assert_eq!(text.trim_end(), verbatim.trim_end(), "{verbatim}");
        }
        for doubt in ["a = \"\n\"", "a = '''", "# \u{1}", "a = 1\r2", "# a\rb", "\"\\", "a = '"] {
            assert_eq!(bare(doubt), None, "{doubt:?}");
        }
    }

    #[test]
    fn texts_that_are_alike_bare_are_the_same_table() {
        let seed = "# top\n\"a # b\" = \"x # \\\" y\" # one\n[t]\nd = [ 1, # two\n  'li#t' ]\ne = \"\"\"\n # in \" \"\"\" # out\nf = '''#'''\n\n[[u]] # '\ng = { h = 1, i = 2020-01-01 10:00:00 }\n";
        let words = [
            "#", "\"", "'", "\n", " ", "\t", "\r\n", "=", "[", "]", "\\", "1", "# x \" '", "\"\"\"", "'''", "\u{1}",
            "\r", "\u{feff}", ",", "{", "}",
        ];
        let parsed = |t: &str| toml::from_str::<toml::Table>(t).ok();
        let (first, table) = (bare(seed).unwrap(), parsed(seed).unwrap());
        assert_eq!(bare(&first).as_ref(), Some(&first));
        assert_eq!(parsed(&first).as_ref(), Some(&table));
        let mut dice = 7u64;
        let mut roll = |n: usize| {
            dice = dice.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (dice >> 33) as usize % n
        };
        let mut alike = 0;
        for _ in 0..20_000 {
            let mut text: Vec<char> = seed.chars().collect();
            for _ in 0..=roll(3) {
                let at = roll(text.len());
                let end = at + roll(3).min(text.len() - at);
                text.splice(at..end, words[roll(words.len())].chars());
            }
            let text: String = text.into_iter().collect();
            if bare(&text).as_ref() == Some(&first) {
                alike += 1;
                assert_eq!(parsed(&text).as_ref(), Some(&table), "{text}");
            }
        }
        assert!(alike > 1000, "{alike}");
    }
}
