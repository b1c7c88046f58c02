"""Header words of other languages as the English words that `headers` knows: one plain table.

Latin words stand without accents and in lower case; a key of several words holds single spaces. Words of Chinese and
Japanese are written without spaces between them, so that they are looked up inside longer texts, the longest first.
"""

import re
import unicodedata

LATIN = {
    # French
    "articulation": "joint",
    "articulaire": "joint",
    "heure": "time",
    "temps": "time",
    "horodatage": "timestamp",
    "mesure": "measurement",
    "cible": "target",
    "reflecteur": "reflector",
    "capteur": "sensor",
    "bride": "flange",
    "outil": "tool",
    "lacet": "yaw",
    "tangage": "pitch",
    "roulis": "roll",
    "charge": "payload",
    "charge utile": "payload",
    "fichier": "file",
    "rayon": "radius",
    "effecteur": "effector",
    # Italian
    "giunto": "joint",
    "asse": "axis",
    "angolo": "angle",
    "posizione": "position",
    "punto": "point",
    "tempo": "time",
    "ora": "time",
    "data e ora": "datetime",
    "misura": "measurement",
    "bersaglio": "target",
    "riflettore": "reflector",
    "sensore": "sensor",
    "flangia": "flange",
    "utensile": "tool",
    "attrezzo": "tool",
    "rotazione": "rotation",
    "orientamento": "orientation",
    "orientazione": "orientation",
    "quaternione": "quaternion",
    "imbardata": "yaw",
    "beccheggio": "pitch",
    "rollio": "roll",
    "carico": "payload",
    "carico utile": "payload",
    "immagine": "image",
    "distanza": "distance",
    # Spanish
    "articulacion": "joint",
    "eje": "axis",
    "angulo": "angle",
    "posicion": "position",
    "tiempo": "time",
    "hora": "time",
    "fecha": "date",
    "fecha y hora": "datetime",
    "medicion": "measurement",
    "medida": "measurement",
    "objetivo": "target",
    "brida": "flange",
    "herramienta": "tool",
    "giro": "rotation",
    "rotacion": "rotation",
    "orientacion": "orientation",
    "cuaternion": "quaternion",
    "efector": "effector",
    "guinada": "yaw",
    "cabeceo": "pitch",
    "alabeo": "roll",
    "carga": "payload",
    "carga util": "payload",
    "imagen": "image",
    "archivo": "file",
    "distancia": "distance",
    # Portuguese
    "junta": "joint",
    "eixo": "axis",
    "posicao": "position",
    "ponto": "point",
    "data e hora": "datetime",
    "medicao": "measurement",
    "alvo": "target",
    "refletor": "reflector",
    "ferramenta": "tool",
    "rotacao": "rotation",
    "orientacao": "orientation",
    "quaternio": "quaternion",
    "efetuador": "effector",
    "arfagem": "pitch",
    "rolagem": "roll",
    "imagem": "image",
    "arquivo": "file",
    # Polish
    "os": "axis",
    "przegub": "joint",
    "zlacze": "joint",
    "kat": "angle",
    "pozycja": "position",
    "polozenie": "position",
    "czas": "time",
    "godzina": "time",
    "data": "date",
    "data i czas": "datetime",
    "pomiar": "measurement",
    "cel": "target",
    "czujnik": "sensor",
    "kolnierz": "flange",
    "narzedzie": "tool",
    "obrot": "rotation",
    "orientacja": "orientation",
    "kwaternion": "quaternion",
    "obciazenie": "payload",
    "numer": "number",
    "obraz": "image",
    "plik": "file",
    "odleglosc": "distance",
    # Czech
    "cas": "time",
    "hodina": "time",
    "datum": "date",
    "osa": "axis",
    "kloub": "joint",
    "uhel": "angle",
    "bod": "point",
    "poloha": "position",
    "mereni": "measurement",
    "cil": "target",
    "priruba": "flange",
    "nastroj": "tool",
    "otoceni": "rotation",
    "teplota": "temperature",
    "zatizeni": "payload",
    "cislo": "number",
    "obrazek": "image",
    "soubor": "file",
    "vzdalenost": "distance",
    # Dutch
    "as": "axis",
    "gewricht": "joint",
    "hoek": "angle",
    "punt": "point",
    "positie": "position",
    "tijd": "time",
    "meting": "measurement",
    "meetpunt": "measurement point",
    "doel": "target",
    "flens": "flange",
    "gereedschap": "tool",
    "rotatie": "rotation",
    "temperatuur": "temperature",
    "belasting": "payload",
    "afbeelding": "image",
    "bestand": "file",
    "afstand": "distance",
    # French, Italian, Spanish, Portuguese
    "numero": "number",
    "temperatura": "temperature",
    "sensor": "sensor",
}

EAST_ASIAN = {
    # Chinese; first the simplified, then the traditional characters where they differ
    "关节角度": "joint angle",
    "关节角": "joint angle",
    "关节": "joint",
    "關節角度": "joint angle",
    "關節": "joint",
    "角度": "angle",
    "位置": "position",
    "坐标": "coordinate",
    "座標": "coordinate",
    "位姿": "pose",
    "姿态编号": "pose number",
    "姿態編號": "pose number",
    "姿态": "orientation",
    "姿態": "orientation",
    "旋转角": "rotation angle",
    "旋转": "rotation",
    "旋轉": "rotation",
    "四元数": "quaternion",
    "末端": "flange",
    "时间": "time",
    "時間": "time",
    "日期": "date",
    "温度": "temperature",
    "溫度": "temperature",
    "负载": "payload",
    "負載": "payload",
    "测量": "measured",
    "測量": "measured",
    "目标": "target",
    "目標": "target",
    "靶球": "reflector",
    "法兰": "flange",
    "工具": "tool",
    "编号": "number",
    "序号": "number",
    "图像": "image",
    "横滚": "roll",
    "俯仰": "pitch",
    "偏航": "yaw",
    "弧度": "rad",
    "英寸": "inch",
    "厘米": "cm",
    "毫米": "mm",
    "毫秒": "ms",
    # Japanese
    "関節角度": "joint angle",
    "関節角": "joint angle",
    "関節": "joint",
    "ジョイント": "joint",
    "軸角度": "axis angle",
    "時刻": "time",
    "日時": "datetime",
    "日付": "date",
    "姿勢番号": "pose number",
    "姿勢": "orientation",
    "回転角": "rotation angle",
    "回転": "rotation",
    "クォータニオン": "quaternion",
    "手先": "flange",
    "負荷": "payload",
    "荷重": "payload",
    "可搬質量": "payload",
    "測定": "measured",
    "計測": "measured",
    "反射鏡": "reflector",
    "ターゲット": "target",
    "フランジ": "flange",
    "ツール": "tool",
    "番号": "number",
    "画像": "image",
    "ロール": "roll",
    "ピッチ": "pitch",
    "ヨー": "yaw",
    "インチ": "inch",
    "ミリメートル": "mm",
    "メートル": "m",
    "ラジアン": "rad",
    "ミリ秒": "ms",
    # single characters of both, which stand inside the words above
    "轴": "axis",
    "軸": "axis",
    "点": "point",
    "點": "point",
    "度": "deg",
    "米": "m",
    "秒": "s",
}

LINKING = frozenset(
    "of the about around de del della dello du des la le les el los il lo da do dos der dem den um autour en of".split()
)
"""Articles and prepositions between the component and the object, as in "X of the flange"."""

_MOST_WORDS = max(len(key.split()) for key in LATIN)
_EAST_ASIAN = re.compile("|".join(sorted(map(re.escape, EAST_ASIAN), key=len, reverse=True)))
_NUMBERED = re.compile(r"([a-z]+)(\d+)")


def without_east_asian(text: str) -> str:
    """The text with the words of Chinese and Japanese in English, set off by spaces; full-width signs as plain ones."""
    plain = unicodedata.normalize("NFKC", text) if not text.isascii() else text
    return _EAST_ASIAN.sub(lambda match: f" {EAST_ASIAN[match[0]]} ", plain)


def names_something(text: str) -> bool:
    """Whether a text holds a word of two or more characters of Chinese or Japanese that is known."""
    return any(len(match[0]) > 1 for match in _EAST_ASIAN.finditer(text))


def accented_words(text: str) -> int:
    """Number of known words in a text that are written with letters beyond ASCII."""
    words = {word for word in re.findall(r"\w+", text) if not word.isascii()}
    return sum(without_accents(word).lower() in LATIN for word in words)


def without_accents(text: str) -> str:
    """The text with letters of ASCII in the place of those with accents."""
    decomposed = unicodedata.normalize("NFKD", text.replace("ł", "l").replace("Ł", "L"))
    return "".join(letter for letter in decomposed if not unicodedata.combining(letter))


def in_english(words: list[str]) -> list[str]:
    """Words of a header, lower case without accents, with those of other languages in English."""
    made: list[str] = []
    place = 0
    while place < len(words):
        for count in range(min(_MOST_WORDS, len(words) - place), 0, -1):
            phrase = " ".join(words[place : place + count])
            if phrase in LATIN:
                made += LATIN[phrase].split()
                break
        else:
            count = 1
            made.append(_numbered(words[place]))
        place += count
    return made


def _numbered(word: str) -> str:
    """A word such as "giunto1" with its letters in English."""
    match = _NUMBERED.fullmatch(word)
    return f"{LATIN[match[1]]}{match[2]}" if match and match[1] in LATIN else word
